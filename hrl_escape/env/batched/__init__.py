"""The batched engine: the kinematic rules of thousands of rooms as torch kernels, with the results of `env`'s own."""
