"""Grippers: parallel jaws, vacuum cups, magnets; one YAML file each in this folder.

The grip force is a field of that file: `force` of a jaw or a magnet, `pressure` of a cup. The scenario's `gripper` says
which file is used.
"""
