"""Runs as block means of a signal, with the channels beside it."""
