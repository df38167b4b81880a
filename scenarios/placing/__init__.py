"""Where workpieces are put down: a heap in layers, or a pattern."""
