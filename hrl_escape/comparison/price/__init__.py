"""The price of flatness: what learners over primitives pay for what learners over options have for less."""
