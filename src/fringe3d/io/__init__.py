"""Files: scans, rigs, images and results."""
