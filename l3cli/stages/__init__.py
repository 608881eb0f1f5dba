"""The stages of l3, one per command.

A stage reads files, calls the packages that compute, and writes files. It sends messages to a console.
"""
