"""What comes in, with its times: videos, image folders, track tables."""
