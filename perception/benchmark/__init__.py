"""PS6D, other methods and ablations on the same held-out heaps."""
