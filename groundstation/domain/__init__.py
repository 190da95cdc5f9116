"""Frozen values that all rooms share. Imports nothing of the project outside this folder."""
