"""Tables in the programs that video people use: a filter of VapourSynth, an element of GStreamer (docs/video-hosts.md)."""
