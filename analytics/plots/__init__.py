"""Plots for data sheets and reports."""
