"""One attempt shown again: in 3-D in the browser, or as a film."""
