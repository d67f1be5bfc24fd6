"""What disturbs a rig, one effect per file; a file is imported only when the scene has the section of its name."""
