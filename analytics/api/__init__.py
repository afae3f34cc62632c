"""What `import gyrofleet` offers: functions of arrays, and a store opened for Python."""
