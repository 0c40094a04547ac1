"""Node for a WSG gripper behind a WSG gateway."""
