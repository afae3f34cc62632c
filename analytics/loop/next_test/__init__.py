"""The next test: which run of the station would decide between rival effects, in how many hours, with what power."""
