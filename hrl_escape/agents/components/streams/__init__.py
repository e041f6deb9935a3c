"""Parts of agents that learn from many streams: tensors with a leading dimension, on one device."""
