"""What goes out: tables, video, manifest."""
