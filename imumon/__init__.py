"""imumon: live noise figures of an inertial sensor."""

__version__ = "0.1.0"
