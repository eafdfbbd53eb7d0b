"""The world around a robot: shapes, and φ with its derivatives at any point."""
