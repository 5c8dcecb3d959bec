"""Pushes in torch: the same poses, `gradcheck`, and `torch.func`."""

import numpy as np
import pytest

from gridpush_drake.errors import SimulationError
from gridpush_drake.interop.differentiable import ARGUMENT_NAMES

torch = pytest.importorskip("torch", reason="torch is not installed", exc_type=ImportError)

from gridpush_drake.interop.torch import PushSetting, simulate  # noqa: E402

# torch warns of itself when it loads its derivatives; the kind of warning depends on its version.
pytestmark = [
    pytest.mark.filterwarnings(f"ignore:.torch.jit.script. is deprecated:{kind}")
    for kind in ("FutureWarning", "DeprecationWarning")
]

EVERY = tuple(range(len(ARGUMENT_NAMES)))


def make_tensors(case, requires_grad=False):
    return [
        torch.tensor(value, dtype=torch.float64, requires_grad=requires_grad)
        for value in case.values.values()
    ]


def test_poses_and_both_jacobians_are_the_simulators(case, function):
    values = make_tensors(case)
    poses, blocks = function.expected.differentiate(*case.values.values())
    found = function(*values)
    assert found.dtype == torch.float64
    np.testing.assert_array_equal(found, poses)
    for transform in (torch.func.jacfwd, torch.func.jacrev):
        for block, jacobian in zip(blocks, transform(function, EVERY)(*values), strict=True):
            np.testing.assert_allclose(jacobian, block, rtol=1e-12, atol=1e-15)


def test_gradcheck_is_content(case, function):
    values = make_tensors(case, requires_grad=True)
    assert torch.autograd.gradcheck(
        function, values, eps=1e-6, atol=1e-5, rtol=1e-3, check_forward_ad=True
    )


def test_batches_are_what_single_pushes_are(case, function):
    values = make_tensors(case)
    starts = values[3] + torch.linspace(0.0, 0.001, 3, dtype=torch.float64)[:, None]
    frictions = torch.linspace(0.3, 0.5, 2, dtype=torch.float64)

    def of(start, contact_friction):
        return function(*values[:2], contact_friction, start, *values[4:])

    vmap = torch.func.vmap
    poses = vmap(vmap(of, (None, 0)), (0, None))(starts, frictions)
    slopes = vmap(vmap(torch.func.jacrev(of), (None, 0)), (0, None))(starts, frictions)
    assert poses.shape == (3, 2, 3)
    for i, start in enumerate(starts):
        for j, contact_friction in enumerate(frictions):
            np.testing.assert_array_equal(poses[i, j], of(start, contact_friction))
            alone = torch.func.jacfwd(of)(start, contact_friction)
            np.testing.assert_allclose(slopes[i, j], alone, rtol=1e-12, atol=1e-15)
    # leading dimensions of one's own do the same, and what broadcasts has its gradients summed
    own = starts[:, None].clone().requires_grad_()
    found = function(*values[:2], frictions, own, *values[4:])
    np.testing.assert_array_equal(found.detach(), poses)
    found.sum().backward()
    np.testing.assert_allclose(own.grad[:, 0], slopes.sum(dim=(1, 2)), rtol=1e-10, atol=1e-14)


def test_a_map_is_learned_by_an_optimizer(case):
    """Masses that explain where three pushes ended, from uniform ones."""
    setting = case.make_setting()
    starts = torch.tensor(case.values["start"] + np.array([[0, 0], [0, -0.03], [0, -0.05]]))
    truth = torch.tensor(case.values["mass"])
    common = {"start": starts, "velocity": torch.tensor(case.values["velocity"])}
    seen = simulate(case.obj, setting, mass=truth, **common)
    log_mass = torch.full_like(truth, float(truth.mean().log())).requires_grad_()
    optimizer = torch.optim.Adam([log_mass], lr=0.1)
    losses = []
    for _ in range(25):
        optimizer.zero_grad()
        off = simulate(case.obj, setting, mass=log_mass.exp(), **common) - seen
        loss = (off * torch.tensor([1.0, 1.0, 0.03])).square().sum()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]


def test_what_will_not_do_is_refused(case):
    setting = PushSetting(duration=0.5)
    with pytest.raises(SimulationError, match=r"start has shape \(3,\)"):
        simulate(case.obj, setting, start=np.zeros(3), velocity=np.ones(2))
    with pytest.raises(SimulationError, match=r"velocity is \(0, 0\)"):
        simulate(case.obj, setting, start=np.zeros(2), velocity=np.zeros(2))
