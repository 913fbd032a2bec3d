"""Low level of POMDP-HD: direct transcription of the belief trajectory along one mode sequence."""
