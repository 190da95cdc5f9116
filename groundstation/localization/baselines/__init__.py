"""Methods of the literature that the paper compares itself with, written out where it does not."""
