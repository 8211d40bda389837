"""Slopes with known answers: factors of safety, probabilities, run-outs."""
