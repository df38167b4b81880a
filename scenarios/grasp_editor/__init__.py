"""The page on which grasps are moved, checked, tried and saved."""
