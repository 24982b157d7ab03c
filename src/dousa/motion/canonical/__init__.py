"""What every motion is brought to before it is compared: 20 joints, metres, Y up, a known left side."""
