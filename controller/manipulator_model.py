"""The nominal rigid-body model of an arm, on pinocchio."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property
from itertools import count, islice

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import ConfigurationError
from bus_schema.eigenvalues import eigenvalues
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import RobotDescription
from controller.rigid_bodies.dynamics import RigidBodies
from controller.rigid_bodies.vectors import invert, product


class JointPlaces:
    """Conversion between driven joints, in the URDF's order, and moving joints, in pinocchio's.

    Mimic joints follow other joints: q = S q_driven + o, with constant S. So torques of the driven
    joints are Sᵀ τ, and matrices Sᵀ M S.

    Args:
        order: index of each driven joint in the library's lists, shape (joints,).
        followers: index, number of the driven joint, multiplier and offset of each mimic joint.

    Attributes:
        order: as above.
        couples: whether any joint follows another one.
    """

    def __init__(
        self, order: NDArray[np.int64], followers: list[tuple[int, int, float, float]]
    ) -> None:
        self.order = order
        self.couples = bool(followers)
        self._joints, total = order.size, order.size + len(followers)
        # S has one nonzero value per row: the multiplier, in the driven joint's column.
        self._leader = np.empty(total, dtype=np.int64)
        self._leader[order] = np.arange(order.size)
        self._factor: Vector = np.ones(total)
        self._offset: Vector = np.zeros(total)
        for place, leader, multiplier, offset in followers:
            self._leader[place], self._factor[place] = leader, multiplier
            self._offset[place] = offset
        self._pairs = (self._joints * self._leader[:, None] + self._leader).ravel()
        # For matrices of which only the upper triangle is filled.
        self._upper = (np.minimum.outer(order, order), np.maximum.outer(order, order))

    def positions(self, position: Vector) -> Vector:
        """Return positions of all joints in the library's order."""
        moved = self.rates(position)
        return moved + self._offset if self.couples else moved

    def rates(self, values: Vector) -> Vector:
        """Return velocities or accelerations of all joints in the library's order."""
        moved = values[self._leader]
        return moved * self._factor if self.couples else moved

    def following(
        self, places: list[int]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Return leaders, factors and offsets of the joints at these indices."""
        return self._leader[places], self._factor[places], self._offset[places]

    def torques(self, full: Vector) -> Vector:
        """Return torques as the driven joints feel them, shape (joints,)."""
        if self.couples:  # not by @, which rounds as BLAS does on this CPU
            return np.asarray(np.bincount(self._leader, full * self._factor, self._joints), float)
        return full[self.order]

    def symmetric(self, full: Matrix) -> Matrix:
        """Return a symmetric matrix for the driven joints from the upper triangle for all joints.

        Shape (joints, joints).
        """
        if not self.couples:
            return np.asarray(full[self._upper])
        full = np.triu(full) + np.triu(full, 1).T
        felt = self._factor[:, None] * full * self._factor
        total = np.bincount(self._pairs, felt.ravel(), self._joints**2)
        return np.asarray(total, float).reshape(self._joints, self._joints)


_fault = ""
try:
    import pinocchio
except ImportError as error:  # as in pin 3.9.0; commands without a model still work
    _fault = f"pinocchio cannot be imported ({error}): pip install --upgrade pin"

_POSITIONS = 500
_THIN_M, _LIGHT_KG = 0.01, 1e-3
_LEAST_KG_M2 = 1e-10
_NO_INERTIA = "each joint must move some mass off its axis, or some inertia"


class ManipulatorModel:
    """Rigid-body dynamics M(q) q̈ + C(q, q̇) q̇ + G(q) = τ of an arm.

    Args:
        robot: description of the arm.
        scale: factor on all masses and inertias (1 for the arm as described).
        payload_kg: point mass at the tip, not scaled.
        rotor_inertia_kg_m2: what each joint's rotor adds, not scaled; shape (joints,), None for 0.

    Attributes:
        joints: number of joints.
    """

    def __init__(
        self,
        robot: RobotDescription,
        *,
        scale: float = 1.0,
        payload_kg: float = 0.0,
        rotor_inertia_kg_m2: Vector | None = None,
    ) -> None:
        if _fault:
            raise RobotDescriptionError(f"{robot.path}: {_fault}")
        try:
            urdf = robot.resolved_urdf(payload_kg / scale, "none")  # scaled back below
            self._model = pinocchio.buildModelFromXML(urdf)
            for index, inertia in enumerate(self._model.inertias):
                self._model.inertias[index] = pinocchio.Inertia(
                    scale * inertia.mass, inertia.lever, scale * inertia.inertia
                )
        except (ValueError, RuntimeError) as error:
            raise RobotDescriptionError(f"{robot.path}: pinocchio: {error}") from error
        moving = (*robot.joint_names, *(follower.name for follower in robot.followers))
        missing = [name for name in moving if not self._model.existJointName(name)]
        if missing:
            raise RobotDescriptionError(
                f"{robot.path}: pinocchio does not load the joint {missing}"
            )
        self._data = self._model.createData()
        self._names = moving
        self._tip = self._model.getFrameId(robot.tip_link, pinocchio.FrameType.BODY)
        self.joints = robot.joints
        # pinocchio may order the joints differently from the URDF
        self._places = JointPlaces(
            np.array([self._place(name) for name in robot.joint_names]),
            [
                (self._place(f.name), robot.joint_names.index(f.leader), f.multiplier, f.offset)
                for f in robot.followers
            ],
        )
        self._slides = np.array(robot.slides)
        self._rotors: Vector = np.zeros(robot.joints)
        if rotor_inertia_kg_m2 is not None:
            self._rotors = rotor_inertia_kg_m2
            armature = np.zeros(self._model.nv)
            armature[self._places.order] = rotor_inertia_kg_m2
            self._model.armature = armature

    def rigid_bodies(self) -> RigidBodies:
        """Return the arm's structure, for compiled code."""
        numbers = [int(self._model.getJointId(name)) for name in self._names]
        twists = np.array([self._model.joints[n].createData().S.ravel() for n in numbers])
        slides = np.abs(twists[:, :3]).max(axis=1) > 0.0
        leaders, factors, offsets = self._places.following([self._place(n) for n in self._names])
        carriers = [int(self._model.parents[number]) for number in numbers]
        placements = [self._model.jointPlacements[number] for number in numbers]
        return RigidBodies(
            outwards=np.argsort(numbers).astype(np.int64),
            parents=np.array([numbers.index(c) if c else -1 for c in carriers], dtype=np.int64),
            rotations=np.array([placement.rotation for placement in placements]),
            origins=np.array([placement.translation for placement in placements]),
            axes=np.where(slides[:, None], twists[:, :3], twists[:, 3:]),
            slides=slides,
            leaders=leaders,
            factors=factors,
            offsets=offsets,
            gravity=np.array(self._model.gravity.linear),
        )

    def inertia_table(self) -> Matrix:
        """Return inertias of bodies and rotors, shape (bodies, 11), in `RigidBodies`' format."""
        numbers = (self._model.getJointId(name) for name in self._names)
        links = np.array([self._model.inertias[n].toDynamicParameters() for n in numbers])
        followers = len(self._names) - self.joints
        return np.column_stack([links, np.append(self._rotors, np.zeros(followers))])

    def mass_matrix(self, position: Vector) -> Matrix:
        """Return M(q), shape (joints, joints), kg m² (kg for prismatic joints)."""
        full = pinocchio.crba(self._model, self._data, self._places.positions(position))
        return self._places.symmetric(full)

    def governing_inertia(self, positions: Matrix) -> Vector:
        """Return the inertia by which to size joint gains on a motion, shape (joints,), kg m².

        A joint feels 1 / (M⁻¹)ᵢᵢ while all others are free, far less than Mᵢᵢ where axes are nearly
        parallel. The result m is its minimum over the motion, reduced until no mode of the coupled
        arm sees a gain of k per unit inertia as more than k: the eigenvalues of M⁻¹ diag(m) are at
        most 1.

        Args:
            positions: joint positions on the motion, shape (samples, joints), rad.

        Raises:
            RobotDescriptionError: a joint has no inertia.
        """
        inverses = np.empty((len(positions), self.joints, self.joints))
        for position, inverse in zip(positions, inverses, strict=True):
            invert(self.mass_matrix(position), inverse)
        felt = (1.0 / np.diagonal(inverses, axis1=1, axis2=2)).min(axis=0)
        if not np.all(felt > _LEAST_KG_M2) or not np.all(np.isfinite(felt)):
            own = np.diagonal(self.mass_matrix(positions[0]))
            rows = zip(self._names, own, strict=False)
            light = ", ".join(name for name, inertia in rows if inertia <= _LEAST_KG_M2)
            hint = f"; {light} moves none: leave it out of robot.joints" if light else ""
            raise RobotDescriptionError(f"{_NO_INERTIA}{hint}")
        # M⁻¹ diag(m) has the eigenvalues of the symmetric diag(√m) M⁻¹ diag(√m).
        return np.asarray(felt / _largest_eigenvalue(inverses, np.sqrt(felt)))

    def largest_inertia(self, positions: Matrix, weights: Vector) -> float:
        """Return the largest eigenvalue of W M(q) W, W = diag(weights), in kg m² × weight².

        Args:
            positions: shape (samples, joints), rad.
            weights: shape (joints,).
        """
        return _largest_eigenvalue(map(self.mass_matrix, positions), weights)

    def gravity(self, position: Vector) -> Vector:
        """Return G(q), shape (joints,), N m."""
        full = pinocchio.computeGeneralizedGravity(
            self._model, self._data, self._places.positions(position)
        )
        return self._places.torques(full)

    def gravity_stiffness(self, position: Vector) -> Matrix:
        """Return ∂G/∂q, shape (joints, joints), N m per rad."""
        full = pinocchio.computeGeneralizedGravityDerivatives(
            self._model, self._data, self._places.positions(position)
        )
        return self._places.symmetric(full)

    @property
    def moved_kg(self) -> float:
        """Mass of all moving links, kg."""
        return float(sum(inertia.mass for inertia in self._model.inertias[1:]))

    def inverse_dynamics(self, position: Vector, velocity: Vector, acceleration: Vector) -> Vector:
        """Return the torque of a motion, shape (joints,), N m."""
        places = self._places
        full = pinocchio.rnea(
            self._model, self._data,
            places.positions(position), places.rates(velocity), places.rates(acceleration),
        )  # fmt: skip
        return places.torques(full)

    def torque_along(
        self, position: Vector, velocity: Vector, along_velocity: Vector, acceleration: Vector
    ) -> Vector:
        """Return M(q) a + C(q, q̇) v + G(q), shape (joints,), N m; v may differ from q̇.

        Computed as M a + C q̇ + G, one recursion, plus C (v − q̇), which needs C itself.
        """
        places = self._places
        position, velocity = places.positions(position), places.rates(velocity)
        torque = pinocchio.rnea(
            self._model, self._data, position, velocity, places.rates(acceleration)
        )
        coriolis = pinocchio.computeCoriolisMatrix(self._model, self._data, position, velocity)
        change = places.rates(along_velocity) - velocity
        return places.torques(torque + product(coriolis, change))

    def inertial_parameters(self) -> Vector:
        """Return the parameters of all bodies as `body_parameters` has them, but dimensionless.

        In masses of the link, those times the arm's length scale, and its square.
        """
        return self.body_parameters().ravel() / self._parameter_scales

    def regressor(
        self, position: Vector, velocity: Vector, along_velocity: Vector, acceleration: Vector
    ) -> Matrix:
        """Return Y, N m per parameter, shape (joints, parameters), without rotors.

        Y times `inertial_parameters` is what `torque_along` returns, less the torque of the rotors.
        C(q, q̇) v is symmetric in q̇ and v: half of C(q, q̇ + v) (q̇ + v) − C(q, q̇) q̇ − C(q, v) v.
        """
        still = np.zeros(self.joints)

        def torque(rate: Vector) -> Matrix:
            return self._regressor(position, rate, still)

        squares = torque(velocity + along_velocity) - torque(velocity) - torque(along_velocity)
        full = self._regressor(position, still, acceleration) + 0.5 * (squares + torque(still))
        return full * self._parameter_scales

    @cached_property
    def _parameter_scales(self) -> Vector:
        """A size for each parameter: the link's mass, times a length of the arm, its square."""
        own = self.body_parameters()
        masses = own[:, :1]
        length = math.sqrt(float(own[:, [4, 6, 9]].sum() / masses.sum()))
        return np.ravel(masses * np.repeat([1.0, length, length**2], (1, 3, 6)))

    def torque_regressors(
        self, positions: Matrix, velocities: Matrix, accelerations: Matrix
    ) -> NDArray[np.float64]:
        """Return Y of τ = Y φ along a motion, shape (samples, joints, 10 × bodies).

        φ are the parameters of `body_parameters`, one body after the other.

        Args:
            positions: of the driven joints, shape (samples, joints), rad.
            velocities: same shape, rad/s.
            accelerations: same shape, rad/s².
        """
        motions = zip(positions, velocities, accelerations, strict=True)
        return np.array([self._regressor(*motion) for motion in motions])

    def _regressor(self, position: Vector, velocity: Vector, acceleration: Vector) -> Matrix:
        places = self._places
        full = pinocchio.computeJointTorqueRegressor(
            self._model, self._data,
            places.positions(position), places.rates(velocity), places.rates(acceleration),
        )  # fmt: skip
        full = np.reshape(full, (self._model.nv, -1))  # one row comes as a vector
        if places.couples:
            return np.apply_along_axis(places.torques, 0, full)
        return places.torques(full)  # the same for all columns at once

    def body_parameters(self) -> Matrix:
        """Return the parameters of each moving body, shape (bodies, 10).

        Mass, mass times centre of mass (x, y, z) and inertia about the joint's origin (xx, xy, yy,
        xz, yz, zz), in the frame of the joint that moves the body; with all links fixed to it.
        """
        return np.array([each.toDynamicParameters() for each in self._model.inertias[1:]])

    @property
    def body_joints(self) -> tuple[str, ...]:
        """Names of the joints that move the bodies, in the order of `body_parameters`."""
        return tuple(self._model.names)[1:]

    def energy(self, position: Vector, velocity: Vector) -> float:
        """Return kinetic plus potential energy, J."""
        places = self._places
        motion = places.positions(position), places.rates(velocity)
        return float(pinocchio.computeMechanicalEnergy(self._model, self._data, *motion))

    def tip_position(self, position: Vector) -> Vector:
        """Return the origin of the tip link in the base frame, shape (3,), m."""
        pinocchio.forwardKinematics(self._model, self._data, self._places.positions(position))
        placement = pinocchio.updateFramePlacement(self._model, self._data, self._tip)
        return np.array(placement.translation)

    def tip_positions(self, positions: Matrix) -> Matrix:
        """Return the tip's positions in the base frame, shape (postures, 3), m.

        A point fixed to the tip is carried from each body's frame to that of its parent, for all
        postures at once: pinocchio would need a call for each.

        Args:
            positions: of the driven joints, shape (postures, joints), rad.
        """
        bodies, frame = self._bodies, self._model.frames[self._tip]
        point = np.repeat(frame.placement.translation[:, None], len(positions), axis=1)
        joint = self._model.names[frame.parentJoint]
        body = self._names.index(joint) if joint in self._names else -1
        while body >= 0:
            axis, rotation = bodies.axes[body][:, None], bodies.rotations[body]
            moved = bodies.factors[body] * positions[:, bodies.leaders[body]] + bodies.offsets[body]
            point = point + moved * axis if bodies.slides[body] else _turned(point, axis, moved)
            x, y, z = rotation.T[:, :, None]  # not by @, which rounds as BLAS does on this CPU
            point = x * point[0] + y * point[1] + z * point[2] + bodies.origins[body][:, None]
            body = int(bodies.parents[body])
        return np.asarray(point.T)

    @cached_property
    def _bodies(self) -> RigidBodies:
        return self.rigid_bodies()

    def skeleton(self, position: Vector) -> NDArray[np.float64]:
        """Return the arm's bones in the base frame, shape (bones, 2, 3), m.

        Each bone connects a joint, or the base's origin, to a joint that it carries, or to the tip.
        """
        pinocchio.forwardKinematics(self._model, self._data, self._places.positions(position))
        tip = pinocchio.updateFramePlacement(self._model, self._data, self._tip).translation
        joints = [placement.translation for placement in self._data.oMi]
        carriers = [*self._model.parents[1:], self._model.frames[self._tip].parentJoint]
        ends = zip(carriers, [*joints[1:], tip], strict=True)
        return np.array([(joints[carrier], end) for carrier, end in ends])

    def yaw_pitch_pitch_lengths(self) -> tuple[float, float, float]:
        """Return shoulder height, upper arm and forearm of a yaw-pitch-pitch arm, m.

        Raises:
            ConfigurationError: the arm has another form, or does not lie along x at zero.
        """
        zero = np.zeros(self._model.nv)
        if self._model.nv == self.joints == 3 and not self._slides.any():
            pinocchio.computeJointJacobians(self._model, self._data, zero)
            tip = self.tip_position(zero)
            origins = [self._data.oMi[j].translation for j in range(1, 4)]
            axes = [self._data.J[3:, i] for i in range(3)]
            height, upper_arm, forearm = origins[1][2], origins[2][0], tip[0] - origins[2][0]
            straight = [(0, 0, height), (upper_arm, 0, height), (upper_arm + forearm, 0, height)]
            if np.allclose(axes, [(0, 0, 1), (0, 1, 0), (0, 1, 0)], atol=1e-6) and np.allclose(
                [origins[1], origins[2], tip], straight, atol=1e-6
            ):
                return float(height), float(upper_arm), float(forearm)
        raise ConfigurationError(
            "reference.kind",
            "cartesian_path",
            "needs a three-joint arm that yaws about z, pitches twice about y and lies along x"
            " with all joints at zero; joint_sinusoids and minimum_jerk work for any arm",
        )

    def _place(self, name: str) -> int:
        """Return the index of a joint in pinocchio's lists."""
        return int(self._model.joints[self._model.getJointId(name)].idx_v)


def _turned(points: Matrix, axis: Matrix, angles: Vector) -> Matrix:
    """Return points turned about a unit axis by angles, after Rodrigues.

    Args:
        points: shape (3, points).
        axis: shape (3, 1).
        angles: shape (points,), rad.
    """
    cosine, sine = np.cos(angles), np.sin(angles)
    (x,), (y,), (z,) = axis
    a, b, c = points
    along = (x * a + y * b + z * c) * (1.0 - cosine)
    across = (y * c - z * b, z * a - x * c, x * b - y * a)
    rows = zip(points, across, (x, y, z), strict=True)
    return np.array([cosine * own + sine * side + part * along for own, side, part in rows])


def log_cholesky(parameters: Matrix) -> Matrix:
    """Return coordinates of bodies that may have any values, shape (bodies, 10).

    α, d (3), s (3) and t (3) of the pseudo-inertia e²ᵅ U Uᵀ, where U has e^d on its diagonal: every
    value belongs to a body that is physically possible. t is the centre of mass. After Rucker and
    Wensing, "Smooth Parameterization of Rigid-Body Inertia", IEEE RA-L 7(2), 2022.

    Args:
        parameters: as `ManipulatorModel.body_parameters`; bodies without extent or mass, as in some
            files, get little of both.
    """
    found = []
    for each in parameters:
        pseudo = pinocchio.PseudoInertia.FromDynamicParameters(each).toMatrix()
        least = np.array([_THIN_M**2, _THIN_M**2, _THIN_M**2, 1.0]) * max(_LIGHT_KG, pseudo[3, 3])
        if not (np.linalg.eigvalsh(pseudo) > 1e-6 * least.min()).all():
            pseudo = pseudo + np.diag(least * [1.0, 1.0, 1.0, pseudo[3, 3] < _LIGHT_KG])
        upper = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]
        scale = upper[3, 3]
        u = upper / scale
        shears = (u[0, 1], u[1, 2], u[0, 2])
        found.append([np.log(scale), *np.log(np.diag(u)[:3]), *shears, *u[:3, 3]])
    return np.array(found)


def body_from_log_cholesky(coordinates: Vector) -> tuple[Vector, Matrix]:
    """Return the parameters of a body, shape (10,), and their derivatives, shape (10, 10)."""
    body = pinocchio.LogCholeskyParameters(coordinates)
    return body.toDynamicParameters(), body.calculateJacobian()


def _largest_eigenvalue(matrices: Iterable[Matrix], weights: Vector) -> float:
    """Return the largest eigenvalue of W M W over symmetric matrices M, W = diag(weights)."""
    weighted = (weights[:, None] * matrix * weights for matrix in matrices)
    return max(float(eigenvalues(each)[0].max()) for each in weighted)


def spread_positions(robot: RobotDescription) -> Matrix:
    """Return fixed joint positions spread over the joint ranges, shape (samples, joints), rad.

    The first is zero; then multiples of the square roots of primes modulo one fill the ranges
    evenly.
    """
    lower = np.where(np.isfinite(robot.lower_rad), robot.lower_rad, -math.pi)
    upper = np.where(np.isfinite(robot.upper_rad), robot.upper_rad, math.pi)
    primes = (
        number for number in count(2) if all(number % divisor for divisor in range(2, number))
    )
    steps = np.sqrt(list(islice(primes, robot.joints)))
    spread = np.outer(np.arange(_POSITIONS), steps) % 1.0
    straight = np.clip(np.zeros(robot.joints), lower, upper)
    return np.vstack([straight, lower + spread * (upper - lower)])


def largest_load_kg(robot: RobotDescription, limits_nm: Vector) -> float:
    """Return the heaviest tip load that an arm holds in any posture, at most its moved mass, kg.

    Args:
        robot: the arm.
        limits_nm: largest torques of the joints, shape (joints,).
    """
    model, loaded = ManipulatorModel(robot), ManipulatorModel(robot, payload_kg=1.0)
    positions = spread_positions(robot)
    own = np.array([model.gravity(position) for position in positions])
    of_load = np.array([loaded.gravity(position) for position in positions]) - own
    with np.errstate(divide="ignore", invalid="ignore"):
        most = (limits_nm - np.sign(of_load) * own) / np.abs(of_load)
    return min(model.moved_kg, max(0.0, float(np.nanmin(most))))
