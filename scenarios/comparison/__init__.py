"""Campaigns over the same bins compared: baseline, gate, sweep, attribution, pytest plugin."""
