"""The batched engine: the kinematic rules of thousands of rooms as torch kernels, equal to `kinematics.py`."""
