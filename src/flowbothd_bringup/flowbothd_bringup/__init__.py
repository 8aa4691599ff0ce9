"""The flowbothd command line, launch files, parameters, demo and evaluation."""
