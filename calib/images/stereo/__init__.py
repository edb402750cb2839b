"""The stereo reference: pose of C2, and depths of boards by triangulation."""
