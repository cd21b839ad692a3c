"""Effects: sources of torque beyond the rigid bodies of the given links, a file per family."""

# registered, and so listed and considered, in this order
from excitant.robots.effects.friction import AsymmetricFriction as AsymmetricFriction
from excitant.robots.effects.friction import CoulombFriction as CoulombFriction
from excitant.robots.effects.friction import FrictionCoupling as FrictionCoupling
from excitant.robots.effects.friction import (
    LoadDependentFriction as LoadDependentFriction,
)
from excitant.robots.effects.friction import (
    NonlinearViscousFriction as NonlinearViscousFriction,
)
from excitant.robots.effects.friction import (
    PreslidingHysteresis as PreslidingHysteresis,
)
from excitant.robots.effects.friction import StribeckFriction as StribeckFriction
from excitant.robots.effects.friction import (
    ThermalFrictionDrift as ThermalFrictionDrift,
)
from excitant.robots.effects.friction import ViscousFriction as ViscousFriction

# isort: split
from excitant.robots.effects.drive import Backlash as Backlash
from excitant.robots.effects.drive import InertiaCoupling as InertiaCoupling
from excitant.robots.effects.drive import JointElasticity as JointElasticity
from excitant.robots.effects.drive import RotorInertia as RotorInertia
from excitant.robots.effects.drive import Spring as Spring
from excitant.robots.effects.drive import TorqueOffset as TorqueOffset
from excitant.robots.effects.drive import TorqueRipple as TorqueRipple

# isort: split
from excitant.robots.effects.sensing import EncoderOffset as EncoderOffset
from excitant.robots.effects.sensing import EncoderScale as EncoderScale
from excitant.robots.effects.sensing import TimeDelay as TimeDelay
from excitant.robots.effects.sensing import TorqueGain as TorqueGain

# isort: split
from excitant.robots.effects.body import AddedInertia as AddedInertia
from excitant.robots.effects.body import GivenInertias as GivenInertias
from excitant.robots.effects.body import GravityDirection as GravityDirection
from excitant.robots.effects.body import InertialParameters as InertialParameters
from excitant.robots.effects.body import KinematicError as KinematicError
from excitant.robots.effects.body import Payload as Payload

# isort: split
from excitant.robots.effects.base import EFFECTS as EFFECTS
from excitant.robots.effects.base import Acts as Acts
from excitant.robots.effects.base import Effect as Effect
from excitant.robots.effects.base import Export as Export
from excitant.robots.effects.base import JointEffect as JointEffect
from excitant.robots.effects.base import JointwiseEffect as JointwiseEffect
from excitant.robots.effects.base import PairEffect as PairEffect
from excitant.robots.effects.base import Parameter as Parameter
from excitant.robots.effects.base import Physics as Physics
from excitant.robots.effects.base import Size as Size
from excitant.robots.effects.base import Words as Words
from excitant.robots.effects.base import effect_entries as effect_entries
from excitant.robots.effects.base import effects_from_entries as effects_from_entries
from excitant.robots.effects.base import merged as merged
from excitant.robots.effects.base import plain as plain
from excitant.robots.effects.base import proposals as proposals
from excitant.robots.effects.base import registered as registered
from excitant.robots.effects.base import standard_effects as standard_effects
from excitant.robots.effects.experiments import (
    separating_experiment as separating_experiment,
)
from excitant.robots.effects.search import JointFacts as JointFacts
from excitant.robots.effects.search import Search as Search
from excitant.robots.effects.search import Shape as Shape
from excitant.robots.effects.search import alternatives as alternatives
from excitant.robots.effects.search import effect_values as effect_values
from excitant.robots.effects.search import joint_facts as joint_facts
from excitant.robots.effects.search import plausible as plausible
