"""`pickproof grasps ...`: commands on grasp points."""
