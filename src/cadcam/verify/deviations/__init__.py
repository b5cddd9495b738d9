"""How far edges and features are from where the CAD has them, how sure that is, and what may lead edges astray."""
