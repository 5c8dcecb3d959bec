"""The problem of learning from pushes: residuals, noise, outliers and the posterior."""
