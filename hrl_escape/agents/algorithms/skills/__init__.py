"""Skills and options found without a task, or backwards from one."""
