"""The arm, its drives and sensors, its installation, and the world model."""
