"""The contract of a planning call: request and result, objectives, and the search for better plans."""
