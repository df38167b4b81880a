"""PS6D, its peers and its ablations on the same held-out heaps."""
