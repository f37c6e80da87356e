# Lets CMake projects build against ROS packages installed from Python wheels; without effect on any other ROS.
# Passed as CMAKE_PROJECT_INCLUDE, so it runs right after project().

# The wheels bring no setup script. In an active virtual environment that has them, the ament index is there.
if("$ENV{AMENT_PREFIX_PATH}" STREQUAL "" AND EXISTS "$ENV{VIRTUAL_ENV}/share/ament_index")
  set(ENV{AMENT_PREFIX_PATH} "$ENV{VIRTUAL_ENV}")
endif()

# The exported targets of the wheels name include folders of the machine they were built on (its Python and NumPy
# headers), and CMake refuses imported targets whose include folders do not exist. These folders are dropped; the
# right ones come from find_package(Python3) anyway.
function(drop_missing_include_directories)
  get_property(targets DIRECTORY "${CMAKE_SOURCE_DIR}" PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(present "")
    foreach(directory IN LISTS directories)
      # Generator expressions cannot be looked up; they stay.
      if(directory MATCHES "\\$<" OR EXISTS "${directory}")
        list(APPEND present "${directory}")
      endif()
    endforeach()
    set_target_properties("${target}" PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${present}")
  endforeach()
endfunction()

# At the end of the top-level CMakeLists.txt, when all packages have been found.
cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL drop_missing_include_directories)
