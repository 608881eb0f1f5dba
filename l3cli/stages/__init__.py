"""The stages. Each reads its input files, calls the computing packages, and writes its output; messages go to a console."""
