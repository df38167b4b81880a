"""Grippers: parallel jaws, vacuum cups, magnets; one YAML file each in this folder."""
