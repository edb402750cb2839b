"""What a lab may have done wrong: hypotheses tried after the fit, and the decisive ones named."""
