"""A user's CAD file made a workpiece with grasps and a cell."""
