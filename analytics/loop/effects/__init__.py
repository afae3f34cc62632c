"""Effects that a gyro's error model may lack, one file for each family."""
