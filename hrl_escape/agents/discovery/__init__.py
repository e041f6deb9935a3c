"""Discovery: options made while learning, from the graph of the states that were met."""
