"""Still pictures of objects and grasps: a small renderer, what a picture shows, and its colours."""
