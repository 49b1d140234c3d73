"""The command `analyze`: one clip to one result folder."""
