"""From a camera to a recording: poses of parts by printed tags in a video. Needs the extra `vision` (OpenCV)."""
