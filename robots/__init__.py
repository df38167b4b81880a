"""Tool poses become joint trajectories. The only folder that imports pinocchio, coal, ompl and ruckig."""

import cell  # noqa: F401  fixes the numeric profile before numpy is loaded
