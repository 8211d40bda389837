"""What a step, a screening, a gradient and a campaign cost."""
