"""What has to be known, checked and mended of a URDF before a simulator sees it."""
