"""The error of the next registration, predicted: in closed form and by simulation."""
