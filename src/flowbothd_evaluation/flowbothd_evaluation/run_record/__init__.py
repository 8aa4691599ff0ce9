"""The record of one run: written, read, plotted and drawn."""
