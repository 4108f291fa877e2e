"""A computed-torque law with a filter on its velocity error."""

from funnel_hil import Diagnostics


class FilteredTorque:
    def __init__(self, model, stiffness=400.0, damping=40.0, filter_s=0.002):
        self.diagnostics = Diagnostics(model.joints)
        self.model, self.stiffness, self.damping = model, stiffness, damping
        self.filter_s, self.error_rate = filter_s, None

    def reset(self):
        self.error_rate = None

    def torque(self, tracking):
        if self.error_rate is None:
            self.error_rate = tracking.error_rate.copy()
        share = tracking.step_s / (self.filter_s + tracking.step_s)
        self.error_rate += share * (tracking.error_rate - self.error_rate)
        acceleration = (
            tracking.reference_acceleration
            - self.stiffness * tracking.error
            - self.damping * self.error_rate
        )
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, acceleration)
