"""What an estimation is fed and what it shows while it runs: files with roles, frames as they come."""
