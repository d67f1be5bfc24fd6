"""What changes the equation of motion of a rig: a belt that ripples, and a shaker."""
