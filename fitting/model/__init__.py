"""The estimated model: parameters, starting values, priors, and the motion they predict."""
