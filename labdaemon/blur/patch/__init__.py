"""What a camera saw of a target: a patch of sensor values, its channels, its light, its noise, its dark blob."""
