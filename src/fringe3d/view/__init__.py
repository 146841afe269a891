"""A result in three dimensions, in the browser."""
