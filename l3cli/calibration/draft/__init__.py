"""Drafts a measurement file for a folder of captures. Files are classified by name and content, and missing data are
marked.
"""
