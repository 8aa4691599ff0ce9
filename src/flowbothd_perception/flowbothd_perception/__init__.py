"""From camera to object cloud: crop, robot-body filter, outlier removal, sampling."""
