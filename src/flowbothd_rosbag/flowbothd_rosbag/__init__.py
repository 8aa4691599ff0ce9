"""rosbag2 recordings: written, mended, read, recorded from a graph and played back."""
