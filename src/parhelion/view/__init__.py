"""Looking at a scene while it is rendered: a session that knows of no web, and its front ends."""
