"""Tables in video programs: a filter of VapourSynth, an element of GStreamer (docs/video.md#vapoursynth)."""
