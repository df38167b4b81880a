"""Training of the network from streamed scenes."""
