"""Points found in a picture and followed through the next ones; the only stage that uses OpenCV."""
