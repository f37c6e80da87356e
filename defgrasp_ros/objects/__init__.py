"""The objects that come with the package: made by formulae, with dimensions and a default material."""

from defgrasp_ros.objects.library import LibraryObject, find_object, object_library

__all__ = ["LibraryObject", "find_object", "object_library"]
