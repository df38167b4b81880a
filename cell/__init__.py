"""What exists in the cell: workpieces, bins, the arm and its gripper, the camera, and the physics that moves them.

The only folder that imports pybullet or casts rays.
"""
