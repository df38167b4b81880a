"""The PyBullet simulation: world, bin filling, arm, trajectory execution, grip, force sensor."""
