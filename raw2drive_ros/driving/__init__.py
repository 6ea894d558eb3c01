"""What drives the car: preprocessing, the one drive function, policy bundles, the safety gate's state machine."""
