"""Attitude units (JJF 1536-2015): what a calibrated unit turned, and how far its attitude is from that of the table."""
