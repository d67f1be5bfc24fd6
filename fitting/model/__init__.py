"""What is estimated: parameters, starting values, priors, and the motion they predict."""
