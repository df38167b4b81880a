"""Tool poses become joint trajectories. The only folder that imports pinocchio, coal, ompl and ruckig."""
