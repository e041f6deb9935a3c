"""Structure learning over factored states, shared by the model-based structure learners."""
