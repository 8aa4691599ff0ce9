"""PyBullet world, depth camera, suction-cup physics and their ROS bridge."""
