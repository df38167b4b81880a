"""The poses of workpieces in depth images and point clouds of the user's own."""
