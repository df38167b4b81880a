"""Commands that make and tune a workpiece."""
