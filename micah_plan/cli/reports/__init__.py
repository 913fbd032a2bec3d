"""What commands say, a file per command: plain data (the JSON keys that scripts rely on), and tables of it."""
