"""A model, or a product of model and task, as a Gymnasium environment, for learners from elsewhere.

env = stl.to_gymnasium(product)                        # the task is the reward, what must be remembered is observed
policy = stl.Policy.from_function(product, act)        # whatever was learned there is judged exactly here
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, overload

from stltool.arguments import one_of, require, whole
from stltool.checking.shield import Shield
from stltool.errors import SettingsError
from stltool.models import MDP
from stltool.models.gymnasium import require_gymnasium
from stltool.product import JointProduct, Product

if TYPE_CHECKING:
    from stltool.envs.model import MDPEnv
    from stltool.envs.product import ProductEnv

__all__ = ["to_gymnasium"]

_ONE_TASK = (
    "an episode has the reward of one task: take that of one, joint.tasks[0], or build a product with all at once, "
    "stl.build_product(model, first & second)"
)


@overload
def to_gymnasium(model: MDP, unavailable: Literal["error", "stay"] = "error") -> MDPEnv: ...
@overload
def to_gymnasium(
    model: Product,
    unavailable: Literal["error", "stay"] = "error",
    *,
    reward: Literal["exact", "surrogate"] = "exact",
    counterfactuals: int = 0,
    shield: Shield | None = None,
    refused: Literal["replace", "error"] = "replace",
) -> ProductEnv: ...
def to_gymnasium(
    model: MDP | Product,
    unavailable: Literal["error", "stay"] = "error",
    *,
    reward: Literal["exact", "surrogate"] = "exact",
    counterfactuals: int = 0,
    shield: Shield | None = None,
    refused: Literal["replace", "error"] = "replace",
) -> Any:
    """A model or a product as a `gymnasium.Env`; its actions are Discrete(A), numbered as in the model.

    Of a model, observations are Discrete(S) (the cells, if states are cells), rewards are 0, and episodes do not end by
    themselves. Of a product, which is of one task:

    observation      Dict: `state` Discrete(S), or if states are cells, `observation`, the environment's own array;
                     `memory` Discrete(Q), the automaton state; `to_go` Discrete(h + 1), steps until the horizon. An
                     episode terminates with the verdict; it is never truncated.
    reward           "exact": 1 when the task is satisfied, else 0, so that the undiscounted return is the verdict, and
                     its mean P. "surrogate": that of [Wang24], at every step until the horizon; it needs a product with
                     encoding="paper"
    counterfactuals  so many transitions, as they would have been with another memory at another step, are in
                     `info["crm-experience"]` after each step, behind the real one (`ProductEnv.counterfactuals`);
                     not with a shield
    shield           one for this product (`stl.shield`): only what it allows is taken, so that P of whatever is learned
                     is at least what it promises. With the rule "ratio", observations have `allowance` Box(0, 1, (1,)),
                     what is left to spend
    refused          what becomes of other actions: "replace" takes the best one, and `info["replaced"]` is True;
                     "error" raises ModelError

    Seeded by `reset(seed=…)`. `info["action_mask"]` (A,) int8 and `action_masks()` (A,) bool mark the actions that are
    available in the current state, and allowed by the shield if there is one. Without a shield, an action that is not
    available raises ModelError, or with `unavailable="stay"` leaves the state unchanged, which is a move that the model
    does not have; with a shield it is refused. Black boxes work, too, but without shields; a model with intervals
    raises SettingsError.
    """
    joint = isinstance(model, JointProduct)
    require(model, (MDP, Product), "to_gymnasium's model", _ONE_TASK if joint else None)
    one_of(unavailable, "unavailable", ("error", "stay"))
    one_of(reward, "reward", ("exact", "surrogate"))
    one_of(refused, "refused", ("replace", "error"))
    counterfactuals = whole(counterfactuals, "counterfactuals", 0)
    require(shield, Shield, "to_gymnasium's shield", "make one: stl.shield(product, at_least=0.95)", optional=True)
    require_gymnasium()
    if isinstance(model, MDP):
        if reward != "exact" or counterfactuals or shield is not None:
            raise SettingsError(
                "rewards, counterfactuals and shields are those of a task; give a product of model and task"
            )
        from stltool.envs.model import MDPEnv

        return MDPEnv(model, unavailable)
    from stltool.envs.product import ProductEnv

    if shield is not None:
        if counterfactuals:
            raise SettingsError(
                "counterfactual transitions are of runs without a shield; leave counterfactuals out, or shield"
            )
        shield.require_for(model)
    return ProductEnv(model, unavailable, reward, counterfactuals, shield, refused)
