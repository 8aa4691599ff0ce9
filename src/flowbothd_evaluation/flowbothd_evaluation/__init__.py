"""How good the robot is: stepped rollouts, experiments, benchmarks."""
