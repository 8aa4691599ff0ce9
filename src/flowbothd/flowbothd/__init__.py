"""The flowbothd command line."""
