"""What all commands share: options, output, interrupts, and the kernels' compilation."""
