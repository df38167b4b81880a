"""Grasp points on the CAD become ranked grasp candidates, each with the reason that ruled it out."""
