"""What the arm opens: committed poses, runs with the true flow at them, search for poses."""
