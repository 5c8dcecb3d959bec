from .block_learner import BlockLearner as BlockLearner
from .block_learner import BlockLearnerOptions as BlockLearnerOptions
from .feedback_controller import FeedbackController as FeedbackController
from .feedback_controller import FeedbackDecision as FeedbackDecision
from .feedback_controller import FeedbackOptions as FeedbackOptions
from .sliding_block import BlockEstimate as BlockEstimate
from .sliding_block import DrivenDisc as DrivenDisc
from .sliding_block import SlidingBlock as SlidingBlock
