"""The LCP model as systems, of one object and of several."""
