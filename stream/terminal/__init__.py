"""What commands share: options, output for people and programs, completion."""
