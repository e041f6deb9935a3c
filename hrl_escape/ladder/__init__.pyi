from .references import RungReferences, load_references

__all__ = ["RungReferences", "load_references"]
