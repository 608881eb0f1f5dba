"""The stages of l3, one per command.

A stage reads files, calls the packages that compute, writes files, and sends messages to a console.
"""
