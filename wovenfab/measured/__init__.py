"""What others have measured: curves of testing machines, and clouds of points of cameras."""
