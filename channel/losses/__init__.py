"""Path losses: the mean attenuation of a link in dB, with and without line of sight. Each file has one family."""
