"""What all pages share: language, zone of time, rendering, problems, waiting."""
