"""Effects that a gyro's error model may lack, one file each."""
