"""Collision checks of arm, tool and held part."""
