"""Value types, transforms, errors and the ROS glue that every FlowBotHD package shares."""
