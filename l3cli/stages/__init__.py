"""The stages: files in, file out. Each reads its inputs, asks the rooms and writes its output; messages go to a console."""
