"""The batched engine: the kinematic rules of thousands of rooms as torch kernels, twin by twin of `env`."""
