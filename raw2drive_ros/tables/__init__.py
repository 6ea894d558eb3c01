"""Constants that several rooms share: rates, BEV channels and their colours, the layout of vector inputs."""
