"""Raw2Drive for ROS 2: an end-to-end driver learnt by dual-stream model-based RL."""

__version__ = '0.2.0'
