"""MJCF files of others: settings, joints and floors become those of the twin."""
