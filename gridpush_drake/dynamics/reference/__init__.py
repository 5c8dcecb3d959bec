"""The paper's own forms, slow and independent, which the kernels are tested against.

Song & Boularias, "Learning to Slide Unknown Objects with Differentiable Physics Simulations", RSS
2020: the LCP in maximal coordinates, its solvers as an LCP, a QP and a cone program, and the
closed-form gradient of one step. The names below are imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
