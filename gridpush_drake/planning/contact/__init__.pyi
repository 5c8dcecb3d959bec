from .optimization import ContactPlan as ContactPlan
from .optimization import optimize_contact as optimize_contact
from .reachable_outline import ReachableOutline as ReachableOutline
from .reachable_outline import find_reachable_outline as find_reachable_outline
from .trial import ContactOptions as ContactOptions
from .trial import PlannedPush as PlannedPush
from .trial import calc_goal_error as calc_goal_error
